"""What is measured of the cell itself: how the scanner sits on the flange."""
