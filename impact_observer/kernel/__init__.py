"""What is compiled: C++17 by pybind11, without theory; types are in ``_kernel.pyi``."""

from impact_observer.kernel._kernel import triangular

__all__ = ["triangular"]
