"""What is raised where Belfry cannot do what it is asked."""

from __future__ import annotations


class BelfryError(Exception):
    """What the program would print after "error:", with its causes."""

    message: str
    causes: tuple[str, ...]

    def __init__(self, message: str, causes: list[str] | tuple[str, ...] = ()) -> None:
        super().__init__(message, causes)
        self.message = message
        self.causes = tuple(causes)

    def __str__(self) -> str:
        return "\n  caused by: ".join((self.message, *self.causes))


class ArgumentError(BelfryError, ValueError):
    """An argument that cannot be meant; its message names the argument."""
