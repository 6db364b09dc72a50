/* Dense algebra, row-major with NZ columns: Householder, Jacobi, Cholesky, and a small quadratic program. */
#ifndef OPTIMISER_ALGEBRA_H
#define OPTIMISER_ALGEBRA_H

#include "optimiser_evaluate.h"

/* Householder: rows (k of n free variables) = [T' 0] Q'; basis holds Q, triangle T (upper). false where rank is lost. */
static bool factorise(workspace_t *s, int k, int n)
{
  real_t *a = s->memory.reflected;
  for (int i = 0; i < n; i++) {
    for (int j = 0; j < n; j++) {
      s->memory.basis[(i * NZ) + j] = (i == j) ? R(1.0) : R(0.0);
    }
  }
  for (int j = 0; j < k; j++) {
    real_t whole = R(0.0);
    real_t rest = R(0.0);
    for (int i = 0; i < n; i++) {
      const real_t square = a[(j * NZ) + i] * a[(j * NZ) + i];
      whole += square;
      rest += (i >= j) ? square : R(0.0);
    }
    if (!(rest > (EDGE * whole))) {
      return false;
    }
    {
      const real_t norm = sqrt(rest);
      const real_t corner = (a[(j * NZ) + j] > R(0.0)) ? -norm : norm;
      real_t v[NZ] = {R(0.0)};
      real_t square = R(0.0);
      for (int i = j; i < n; i++) {
        v[i] = a[(j * NZ) + i] - ((i == j) ? corner : R(0.0));
        square += v[i] * v[i];
      }
      for (int l = j; l < k; l++) {
        real_t dot = R(0.0);
        for (int i = j; i < n; i++) {
          dot += a[(l * NZ) + i] * v[i];
        }
        for (int i = j; i < n; i++) {
          a[(l * NZ) + i] -= R(2.0) * dot * v[i] / square;
        }
      }
      for (int l = 0; l < n; l++) {
        real_t dot = R(0.0);
        for (int i = j; i < n; i++) {
          dot += s->memory.basis[(l * NZ) + i] * v[i];
        }
        for (int i = j; i < n; i++) {
          s->memory.basis[(l * NZ) + i] -= R(2.0) * dot * v[i] / square;
        }
      }
      for (int l = j; l < k; l++) {
        s->memory.triangle[(j * (NT + 1)) + l] = a[(l * NZ) + j];
      }
    }
  }
  return true;
}

/* Cyclic Jacobi on reduced (d, d): eigenvalues on its diagonal, eigenvectors as columns of turn. */
static void diagonalise(workspace_t *s, int d)
{
  real_t *a = s->memory.reduced;
  real_t *u = s->memory.turn;
  bool turned = true; /* whether a pair was not negligible */
  for (int i = 0; i < d; i++) {
    for (int j = 0; j < d; j++) {
      u[(i * NZ) + j] = (i == j) ? R(1.0) : R(0.0);
    }
  }
  for (int sweep = 0; (sweep < SWEEPS) && turned; sweep++) {
    turned = false;
    for (int p = 0; p < (d - 1); p++) {
      for (int q = p + 1; q < d; q++) {
        const real_t off = a[(p * NZ) + q];
        const real_t half = (a[(q * NZ) + q] - a[(p * NZ) + p]) / R(2.0);
        const real_t reach = fabs(half) + sqrt((half * half) + (off * off));
        turned = turned || ((off * off) > (EPSILON * EPSILON * fabs(a[(p * NZ) + p] * a[(q * NZ) + q])));
        if (reach > R(0.0)) {
          const real_t tangent = ((half < R(0.0)) ? -off : off) / reach;
          const real_t cosine = R(1.0) / sqrt(R(1.0) + (tangent * tangent));
          const real_t sine = tangent * cosine;
          for (int k = 0; k < d; k++) {
            const real_t left = a[(k * NZ) + p];
            const real_t right = a[(k * NZ) + q];
            const real_t first = u[(k * NZ) + p];
            const real_t second = u[(k * NZ) + q];
            a[(k * NZ) + p] = (cosine * left) - (sine * right);
            a[(k * NZ) + q] = (sine * left) + (cosine * right);
            u[(k * NZ) + p] = (cosine * first) - (sine * second);
            u[(k * NZ) + q] = (sine * first) + (cosine * second);
          }
          for (int k = 0; k < d; k++) {
            const real_t upper = a[(p * NZ) + k];
            const real_t lower = a[(q * NZ) + k];
            a[(p * NZ) + k] = (cosine * upper) - (sine * lower);
            a[(q * NZ) + k] = (sine * upper) + (cosine * lower);
          }
        }
      }
    }
  }
}

/* Solves S x = b for the symmetric positive definite schur (w, w), which is destroyed; b becomes x. */
static bool solve_schur(workspace_t *s, int w, real_t *b)
{
  real_t *a = s->memory.schur;
  for (int j = 0; j < w; j++) {
    const real_t whole = a[(j * NZ) + j];
    for (int k = 0; k < j; k++) {
      a[(j * NZ) + j] -= a[(j * NZ) + k] * a[(j * NZ) + k];
    }
    if (!(a[(j * NZ) + j] > (EDGE * whole))) {
      return false;
    }
    a[(j * NZ) + j] = sqrt(a[(j * NZ) + j]);
    for (int i = j + 1; i < w; i++) {
      for (int k = 0; k < j; k++) {
        a[(i * NZ) + j] -= a[(i * NZ) + k] * a[(j * NZ) + k];
      }
      a[(i * NZ) + j] /= a[(j * NZ) + j];
    }
  }
  for (int i = 0; i < w; i++) {
    for (int k = 0; k < i; k++) {
      b[i] -= a[(i * NZ) + k] * b[k];
    }
    b[i] /= a[(i * NZ) + i];
  }
  for (int i = w - 1; i >= 0; i--) {
    for (int k = i + 1; k < w; k++) {
      b[i] -= a[(k * NZ) + i] * b[k];
    }
    b[i] /= a[(i * NZ) + i];
  }
  return true;
}

/* Maximise g'y - y'By/2 subject to rows y >= limits, limits <= 0; inverse holds the inverse of B. Primal active sets
 * from y = 0; multipliers of the rows go to s->memory.multipliers. Whatever ends the loop, y is feasible. */
static void solve_program(workspace_t *s, int d, int n_rows, const real_t *g, real_t *y)
{
  int working[NZ] = {0};
  int n_working = 0;
  bool done = false;
  for (int i = 0; i < d; i++) {
    y[i] = R(0.0);
  }
  for (int j = 0; j < n_rows; j++) {
    s->memory.multipliers[j] = R(0.0);
  }
  for (int turn = 0; (turn < (4 * ROWS)) && !done; turn++) {
    real_t goal[NZ];
    real_t nu[NZ];
    int block = -1;
    real_t part = R(1.0);
    for (int w = 0; w < n_working; w++) {
      const real_t *row = &s->memory.rows[working[w] * NZ];
      nu[w] = s->memory.limits[working[w]];
      for (int i = 0; i < d; i++) {
        real_t sum = R(0.0);
        for (int k = 0; k < d; k++) {
          sum += s->memory.inverse[(i * NZ) + k] * row[k];
        }
        s->memory.through[(w * NZ) + i] = sum;
        nu[w] -= sum * g[i];
      }
      for (int v = 0; v <= w; v++) {
        real_t sum = R(0.0);
        for (int i = 0; i < d; i++) {
          sum += s->memory.through[(w * NZ) + i] * s->memory.rows[(working[v] * NZ) + i];
        }
        s->memory.schur[(w * NZ) + v] = sum;
      }
    }
    if (!solve_schur(s, n_working, nu)) {
      break;
    }
    for (int i = 0; i < d; i++) {
      goal[i] = R(0.0);
      for (int k = 0; k < d; k++) {
        goal[i] += s->memory.inverse[(i * NZ) + k] * g[k];
      }
      for (int w = 0; w < n_working; w++) {
        goal[i] += s->memory.through[(w * NZ) + i] * nu[w];
      }
    }
    for (int j = 0; (j < n_rows) && (n_working < d); j++) {
      real_t slope = R(0.0);
      real_t slack = -s->memory.limits[j];
      real_t size = R(0.0);
      bool in = false;
      for (int w = 0; w < n_working; w++) {
        in = in || (working[w] == j);
      }
      for (int i = 0; i < d; i++) {
        const real_t along = s->memory.rows[(j * NZ) + i] * (goal[i] - y[i]);
        slope += along;
        size += fabs(along);
        slack += s->memory.rows[(j * NZ) + i] * y[i];
      }
      if (!in && (slope < (-EPSILON * R(10.0) * size)) && (slack < (-slope * part))) {
        part = (slack > R(0.0)) ? (slack / -slope) : R(0.0);
        block = j;
      }
    }
    for (int i = 0; i < d; i++) {
      y[i] += part * (goal[i] - y[i]);
    }
    if (block >= 0) {
      working[n_working] = block;
      n_working++;
    } else {
      int worst = -1;
      real_t lowest = R(0.0);
      for (int w = 0; w < n_working; w++) {
        if (nu[w] < lowest) {
          lowest = nu[w];
          worst = w;
        }
      }
      if (worst < 0) {
        for (int w = 0; w < n_working; w++) {
          s->memory.multipliers[working[w]] = nu[w];
        }
        done = true;
      } else {
        n_working--;
        working[worst] = working[n_working];
      }
    }
  }
}

#endif /* OPTIMISER_ALGEBRA_H */
