"""Tools: files, numbers, texts, remarks and the terminal."""
