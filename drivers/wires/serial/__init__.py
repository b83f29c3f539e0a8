"""Present path of the serial driver's entry point."""
