"""Evidence for and against stiction in a record, independent of a fitted model."""
