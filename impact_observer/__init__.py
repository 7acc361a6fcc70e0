"""Know the whole state of an impacting mechanical system from its impact times alone.

Rooms, each importing only from those before it: ``model``, ``dynamics``, ``plant`` and
``observer``, ``analysis``, ``bag``, ``nodes``, ``cli``. The modules beside this file are the
vocabulary that all rooms share: errors, stamps, events, states. The first five rooms need
numpy and scipy only.
"""

__version__ = "0.1.0"
