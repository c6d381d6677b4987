"""Linear and nonlinear algebra that several kinds of mechanics share."""
