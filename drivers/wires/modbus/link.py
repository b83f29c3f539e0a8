"""Present path of the Modbus drivers' entry points."""

from drivers.wires.modbus_link import ModbusDriver as ModbusDriver
from drivers.wires.modbus_link import ModbusRtuDriver as ModbusRtuDriver
