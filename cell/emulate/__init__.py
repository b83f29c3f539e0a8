"""An emulated robot controller in a process of its own, behind a pseudo-terminal or a loopback socket."""
