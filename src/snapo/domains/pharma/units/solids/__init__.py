"""From crystals to tablets: granulation, compaction, release of the drug."""
