"""The paper's operative procedure: augmented reality, and hand guiding to the incision.

Augmented reality needs OpenCV (the extra ``vision``).
"""
