"""Links to real controllers: each turns the client's calls into the bytes of one wire."""
