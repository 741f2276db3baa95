"""Sets: from one file to thousands of shots, on one machine or many.

`layout` says where the files of a set lie; `index` lists them for whoever reads a set.
"""
