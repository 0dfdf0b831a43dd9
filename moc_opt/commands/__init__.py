"""The commands of `moc-opt`, declared in ``parser``."""
