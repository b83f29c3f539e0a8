"""Set-cover problems from public libraries: their files, and what `cell cover` says about them."""
