// The loop of a recurrence: a group of LANES members goes through all its steps before the next group starts.
//
// In, written before this text: the numbers of rows N, N_E, N_C, N_D, N_M, the size WORK of the working space, whether
// there is a fast step (FAST), and `call_step`, `call_fast`, `call_refresh`. Out: `flexopt_recurrence`. What a member
// computes is the same in every lane and beside any other member.

struct state {
  lane x[N + 1], d[N_D + 1];
};

// States of even and of odd steps take turns, so that nothing is copied.
struct room {
  state side[2];
  lane e[N_E + 1], c[N_C + 1], monitor[N_M + 1], top[N_M + 1], turn, w[WORK + 1];
  mask lost;
};

// Strides count numbers; a stride of members of 0 means one value for all of them, e_step = 0 one for all steps.
struct job {
  const double *x0, *c, *e;
  double *x, *monitor, *last;
  long long members, steps, stride, every;
  long long x0_row, x0_member, c_row, c_member, e_step, e_row, e_member;
};

// Lanes beyond the last member repeat it.
INLINE void take(lane *to, int rows, const double *from, long long row, long long member, int count) {
  for (int k = 0; k < rows; ++k, from += row) {
    if (member == 0) to[k] = lane(*from);
    else if (member == 1 && count == LANES) to[k] = vec(*(const loose *)from);
    else for (int l = 0; l < LANES; ++l) to[k].v[l] = from[(l < count ? l : count - 1) * member];
  }
}

INLINE void give(double *to, int rows, const lane *from, long long row, int count) {
  for (int k = 0; k < rows; ++k, to += row) {
    if (count == LANES) *(loose *)to = from[k].v;
    else for (int l = 0; l < count; ++l) to[l] = from[k].v[l];
  }
}

INLINE mask not_a_number(lane a) { return a.v != a.v; }

#if FAST
// The exact step where the fast one is not valid. A member whose states the exact step could not save is lost: while
// its `turn` is NaN it stays with the fast step, so that it does not hold up the others for ever.
static __attribute__((noinline, cold)) int rescue(room &r, const state &now, state &next) {
  mask nan = not_a_number(r.turn), bad = ~(r.turn.v <= splat(1)) & ~(r.lost & nan);
  if (!any(bad)) return 0;
  state exact;
  lane monitor[N_M + 1];
  int status = call_step(now.x, r.e, r.c, exact.x, monitor, r.w);
  status |= call_refresh(exact.x, r.c, exact.d, r.w);
  mask gone = {};
  for (int k = 0; k < N; ++k) {
    next.x[k] = pick(bad, exact.x[k].v, next.x[k].v);
    gone |= not_a_number(exact.x[k]);
  }
  for (int k = 0; k < N_D; ++k) next.d[k] = pick(bad, exact.d[k].v, next.d[k].v);
  for (int k = 0; k < N_M; ++k) r.monitor[k] = pick(bad, monitor[k].v, r.monitor[k].v);
  r.lost |= bad & gone;
  return status;
}

static __attribute__((noinline)) int renew(room &r, state &now) { return call_refresh(now.x, r.c, now.d, r.w); }
#endif

static int group(const job &j, long long i, int count, room &r) {
  int status = 0;
  state *now = r.side, *next = r.side + 1;
  take(now->x, N, j.x0 + i * j.x0_member, j.x0_row, j.x0_member, count);
  take(r.c, N_C, j.c + i * j.c_member, j.c_row, j.c_member, count);
  if (j.steps) take(r.e, N_E, j.e + i * j.e_member, j.e_row, j.e_member, count);
#if FAST
  r.lost = mask{};
  long long left = 0;
#endif
  for (long long k = 0, record = 0; k < j.steps; ++record) {
    long long end = j.steps - k > j.stride ? k + j.stride : j.steps;
    for (int m = 0; m < N_M; ++m) r.top[m] = lane(-__builtin_inf());
    for (; k < end; ++k) {
      if (j.e_step) take(r.e, N_E, j.e + k * j.e_step + i * j.e_member, j.e_row, j.e_member, count);
#if FAST
      if (left-- == 0) {
        status |= renew(r, *now);
        left = j.every - 1;
      }
      status |= call_fast(now->x, now->d, r.e, r.c, next->x, next->d, r.monitor, &r.turn, r.w);
      if (__builtin_expect(any(~(r.turn.v <= splat(1))), 0)) status |= rescue(r, *now, *next);
#else
      status |= call_step(now->x, r.e, r.c, next->x, r.monitor, r.w);
#endif
      state *before = now;
      now = next;
      next = before;
      for (int m = 0; m < N_M; ++m) {
        lane now = r.monitor[m], top = r.top[m];
        r.top[m] = pick((now.v > top.v) | not_a_number(now), now.v, top.v);
      }
    }
    if (j.x) give(j.x + record * N * j.members + i, N, now->x, j.members, count);
    give(j.monitor + record * N_M * j.members + i, N_M, r.top, j.members, count);
  }
  give(j.last + i, N, now->x, j.members, count);
  return status;
}

// Members begin .. end-1. Returns 0, -1 without memory, or what a generated function returned.
extern "C" EXPORT int flexopt_recurrence(const job *j, long long begin, long long end) {
  void *memory = __builtin_malloc(sizeof(room) + sizeof(lane));
  if (!memory) return -1;
  room &r = *(room *)(((unsigned long long)memory + sizeof(lane) - 1) & ~(unsigned long long)(sizeof(lane) - 1));
  int status = 0;
  for (long long i = begin; i < end && !status; i += LANES)
    status = group(*j, i, end - i < LANES ? static_cast<int>(end - i) : LANES, r);
  __builtin_free(memory);
  return status;
}
