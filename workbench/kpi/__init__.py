"""One definition of every figure, for runs and for records."""
