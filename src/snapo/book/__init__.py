"""A book of contracts under many stresses: one file, one command, any executor, the same bits.

- `file`: reads the file of a book: its contracts, markets, stresses and tasks.
- `order`: one contract with its stresses as bytes, and the answer to it.
- `work`: computes an answer: a pure function of the order.
- `plan`: which orders a book needs, and in which sequence.
- `executors`: where orders are computed; `snapo.engine.workers` gives them out, and again where one
  was lost.
- `run`: computes a book into its `folder`; `commands`: the work of the command line.
- `collect`, `sums`, `parquet`, `report`: from answers to sums with errors, tables and the page.
"""
