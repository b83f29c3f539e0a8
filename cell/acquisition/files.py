"""Entry point of earlier installations."""

from cell.scan.acquisition import Files

__all__ = ["Files"]
