"""Input from outside: settings (base class of every TOML table), files, names and plug-ins, all checked when read."""
