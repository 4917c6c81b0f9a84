"""The command line `elastic-arm`: one module per subcommand, each a thin layer over the library."""
