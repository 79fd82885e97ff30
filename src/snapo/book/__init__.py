"""Values a book of contracts under many stresses; any executor returns bit-identical results.

- `file`: reads the file of a book: its contracts, markets, stresses and tasks.
- `job`: one contract with its stresses as bytes, and its result.
- `work`: computes the result of a job, which depends on the job only.
- `plan`: which jobs a book needs, and in which sequence.
- `executors`: the places where jobs are computed; `snapo.engine.workers` sends out the jobs, and
  sends a job again if its worker is lost.
- `run`: computes a book and writes its `folder`; `commands`: the commands of a book.
- `collect`, `sums`, `parquet`, `report`: make sums with errors, tables and the report from the
  results.
"""
