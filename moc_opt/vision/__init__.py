"""Augmented reality, which needs OpenCV (the extra ``vision``), and hand guiding to the incision."""
