"""The sections of a pension report: each reads a `PensionRun` and gives one `Section`."""
