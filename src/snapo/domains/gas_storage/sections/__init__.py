"""The sections of a storage report: each reads a `Run` and gives one `Section` of the page."""
