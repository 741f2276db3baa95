"""Sets: from one file to thousands of shots, on one machine or many.

`definition` reads what a set is, `scenes` says what each of its scenes is, `layout` where its files lie, and `index`
lists them for whoever reads a set.  `unit` makes one scene in one lighting; `run` has all of them made by Dask's
workers (`cluster`), each in a child (`work`), for what the set is made of (`identity`), and keeps a `journal`.
"""
