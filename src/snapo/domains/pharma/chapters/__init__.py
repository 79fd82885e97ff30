"""One module per question about a process: its computation, record and section of the report."""
