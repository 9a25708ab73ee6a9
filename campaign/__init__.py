"""Who runs it: named campaigns, runner, store and command line."""
