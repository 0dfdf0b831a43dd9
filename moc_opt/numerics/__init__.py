"""How small dense algebra is compiled."""
