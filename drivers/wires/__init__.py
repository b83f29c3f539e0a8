"""Links to real controllers: each turns the client's calls into bytes of one wire."""
