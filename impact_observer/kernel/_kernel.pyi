from impact_observer.states import Matrix

def triangular(root: Matrix) -> Matrix:
    """A lower triangular square root, shape (d, d), of the same covariance; (d, any) is given."""
