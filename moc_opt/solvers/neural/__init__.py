"""Recurrent neural networks: the paper's."""
