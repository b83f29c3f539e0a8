"""The Modbus wire, TCP and RTU: registers of a published map."""
