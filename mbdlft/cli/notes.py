"""Warnings beside the output of a command: lines on the error stream, and in its JSON."""

import sys

WARNINGS: list[str] = []  # that this command has shown


def warn(message: object) -> None:
    """Show a warning: one line beside the output."""
    WARNINGS.append(str(message))
    sys.stderr.write(f"mbdlft: warning: {message}\n")
