"""The command ``impact-observer``: one module a subcommand, each a thin skin over a function."""
