"""What comes from outside: files, names, numbers and settings, checked where they are read."""
