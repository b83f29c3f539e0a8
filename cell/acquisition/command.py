"""Entry point of earlier installations."""

from cell.scan.acquisition import Command

__all__ = ["Command"]
