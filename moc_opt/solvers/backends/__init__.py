"""Adapters of libraries, one file each."""
