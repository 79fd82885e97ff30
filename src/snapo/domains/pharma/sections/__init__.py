"""The parts of the report of a pharma run; each reads the files of the run folder only."""
