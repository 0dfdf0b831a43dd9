"""The paper's operative procedure: augmented reality, and hand guiding to the incision.

``augmented_reality`` and its parts need OpenCV (the extra ``vision``).
"""
