"""Pictures, films and layouts: what is drawn, and where."""
