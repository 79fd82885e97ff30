"""A book of contracts under many stresses: one file, one command, any executor, the same bits.

- `file`: reads the file of a book: its contracts, markets, stresses and tasks.
- `order`: one contract with its stresses as bytes, and the answer to it.
- `work`: computes an answer: a pure function of the order.
- `workers`: gives orders to executors, and again where one was lost.
- `sums`: values and errors of sums of contracts, from shares by batch of paths.
- `results`: the folder of a book.
"""
