"""The command line `elastic-arm`: one module a subcommand, each a thin layer over the library."""
