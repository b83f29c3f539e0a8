"""Present path of the serial driver's entry point."""

from drivers.wires.serial_link import SerialDriver as SerialDriver
