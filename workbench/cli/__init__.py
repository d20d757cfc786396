"""The `workbench` command: what is asked for in words, and what is said about it."""
