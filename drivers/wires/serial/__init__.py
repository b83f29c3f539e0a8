"""The serial wire: frames with a checksum, and the messages in them."""
