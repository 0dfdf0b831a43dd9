"""Runs and plans as tables and pages.

Nothing is imported here, because plotting libraries load slowly.
"""
