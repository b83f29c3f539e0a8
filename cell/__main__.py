"""`python -m cell` is the same as `cell`."""

from cell.cli import main

main()
