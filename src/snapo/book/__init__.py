"""A book of contracts under many stresses: one file, one command, any executor, the same bits.

- `file`: reads the file of a book: its contracts, markets, stresses and tasks.
- `job`: one contract with its stresses as bytes, and its result.
- `work`: computes a result, a pure function of the job.
- `plan`: which jobs a book needs, and in which sequence.
- `executors`: where jobs are computed; `snapo.engine.workers` sends them out, and
  again if a worker is lost.
- `run`: computes a book into its `folder`; `commands`: the work of the command line.
- `collect`, `sums`, `parquet`, `report`: from results to sums with errors, tables and the page.
"""
