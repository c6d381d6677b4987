"""Plans of settings of a case, by which an answer reaches a target for its error."""
