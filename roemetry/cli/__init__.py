"""The command line: related verbs in one module; heavy imports stand inside them, so that --help is fast."""
