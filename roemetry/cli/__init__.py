"""The command line: a module a verb; heavy imports stand inside the verbs, so that --help is fast."""
