"""The live view of a running plant and its observers: what `watch` receives, keeps and shows."""
