"""Build the extension module with the headers of the installed NumPy."""

from glob import glob

import numpy
from setuptools import Extension, setup

setup(
    ext_modules=[
        Extension(
            "moc_opt.core._core",
            sources=sorted(glob("moc_opt/core/*.c")),
            depends=sorted(glob("moc_opt/core/*.h")),
            include_dirs=[numpy.get_include()],
            extra_compile_args=["-std=c11", "-O3", "-ffp-contract=off", "-fno-math-errno"],
            py_limited_api=True,
        )
    ]
)
