"""Small dense linear algebra as SX graphs, any size, no pivoting on numbers.

In: SX matrices. Out: SX matrices, or Functions made of calls. Knows nothing of machines.
"""

from flexopt.algebra.dense import apply_damped_inverse as apply_damped_inverse
from flexopt.algebra.dense import apply_damped_inverse_transposed as apply_damped_inverse_transposed
from flexopt.algebra.dense import apply_pseudo_inverse as apply_pseudo_inverse
from flexopt.algebra.dense import apply_pseudo_inverse_transposed as apply_pseudo_inverse_transposed
from flexopt.algebra.dense import determinant as determinant
from flexopt.algebra.dense import diagonal as diagonal
from flexopt.algebra.dense import safe_norm as safe_norm
from flexopt.algebra.dense import same_distance as same_distance
from flexopt.algebra.dense import solve_spd as solve_spd
from flexopt.algebra.eigen import called_eigen as called_eigen
from flexopt.algebra.eigen import clusters as clusters
from flexopt.algebra.eigen import direct_eigen as direct_eigen
from flexopt.algebra.eigen import reciprocal as reciprocal
from flexopt.algebra.eigen import symmetric_eigen as symmetric_eigen
from flexopt.algebra.expansion import expanded_vectors as expanded_vectors
