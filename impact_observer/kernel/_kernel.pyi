from impact_observer.states import Matrix

SOURCES: str

def triangular(root: Matrix) -> Matrix: ...
