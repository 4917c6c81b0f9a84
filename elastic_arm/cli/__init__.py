"""The command line `elastic-arm`: one module a subcommand, each a thin door over the library."""
