"""The files of a new rig: its model, its sensors, and what launches its nodes."""
