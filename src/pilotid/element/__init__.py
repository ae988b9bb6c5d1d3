"""The controlled element of a recording: given, named by the file, or identified from u, fd, x."""
