"""Input from outside: settings, files, names and plug-ins, all checked when read."""
