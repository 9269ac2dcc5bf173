from itertools import permutations

import numpy as np

from clbvh.builders.invariants import insert_prim


def test_primitives_are_listed_in_ascending_order_whatever_order_they_arrive_in():
    for order in permutations((2, 3, 5, 7)):
        prim_ids = np.full(7, -1, np.int32)
        for index, prim in enumerate(order):
            insert_prim(prim_ids, 1, 1 + index, prim)
        assert prim_ids.tolist() == [-1, 2, 3, 5, 7, -1, -1]


def test_a_list_may_be_sorted_in_its_own_memory():
    prim_ids = np.array([9, 4, 1, 3, 0], np.int32)
    for index in range(1, 4):
        insert_prim(prim_ids, 1, index, prim_ids[index])
    assert prim_ids.tolist() == [9, 1, 3, 4, 0]
