"""`exact`: null-space elimination."""
