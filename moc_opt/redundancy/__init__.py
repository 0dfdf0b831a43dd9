"""The self-motion: its curve, its continuation, the arm angle, and manipulability along it."""
