"""The paper's augmented reality: camera, board, pose, tracking, and the task drawn into the picture.

Read first: ``augmented_reality`` (all of it put together), then ``board`` and ``pose`` (geometry), ``camera``
and ``image_source`` (where pictures come from: ``render`` by MuJoCo, ``pinhole`` without GL), ``markers``
(finding the board, needs the extra ``vision``), ``tracking`` and ``overlay``. No room of moc_opt imports it;
benchmarks.paper does.
"""
