"""Machine code for this processor, its cache on disk, and memory and threads to run it with."""
