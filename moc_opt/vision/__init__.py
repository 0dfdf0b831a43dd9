"""Camera, board, pose and overlay: the paper's augmented reality."""
