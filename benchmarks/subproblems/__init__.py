"""Subproblems by themselves, without a loop: the certified test sets, random arms, and the sets for other programs.

Read `testset` first: what a set holds and how it is read. `recipes` draws the problems, `certify` finds and proves
their answers, `qpbenchmark` hands them to the program of that name; `arms` are random arms of any number of joints.
"""
