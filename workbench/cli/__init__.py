"""The `workbench` command: what is asked for in words, and what is said about it."""

from workbench.cli.command import app, main

__all__ = ["app", "main"]
