"""Checked input: settings, files, names and plug-ins."""
