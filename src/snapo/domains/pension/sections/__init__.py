"""The sections of a pension report: each reads a `Run` and gives one `Section` of the page."""
