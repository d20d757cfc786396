"""Where the `workbench` command starts: it loads the rest where Ctrl-C already ends with one line."""

from __future__ import annotations

import sys


def main() -> None:
    """Run the command (workbench/cli); interrupted while that still loads, it ends with exit code 130."""
    try:
        from workbench.cli import main as command
    except KeyboardInterrupt:
        sys.stderr.write("workbench: interrupted\n")
        sys.exit(130)
    command()


if __name__ == "__main__":
    main()
