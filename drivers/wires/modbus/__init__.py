"""Present path of the Modbus drivers' entry points."""
