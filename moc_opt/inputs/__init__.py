"""Input from outside: settings (the base of every table of a TOML), files, names and plug-ins, checked when read."""
