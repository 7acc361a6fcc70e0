"""Plant and estimates seen moving: where all is drawn, films, shapes of any tool."""
