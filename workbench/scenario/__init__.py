"""Scenario files: the closed YAML schema, the loader whose errors carry line and column, and the runner."""
