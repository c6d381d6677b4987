"""Tables of case files: models that read, check and describe their keys."""
