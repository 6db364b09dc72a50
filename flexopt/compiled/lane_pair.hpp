// Two groups of points side by side, in place of one: while results of one are waited for, the other's are computed.
//
// In: `lane.hpp` and `lane_math.hpp`. Out: the same names once more, in a namespace. Meant for short functions: what
// waits is long beside what it takes to keep twice as many values at hand.

namespace paired {

struct vec {
  ::vec a, b;
};
INLINE vec splat(double x) { return {::splat(x), ::splat(x)}; }

struct lane {
  vec v;
  lane() = default;
  lane(vec x) : v(x) {}
  lane(double x) : v(splat(x)) {}
  lane(int x) : v(splat(x)) {}
  lane(long long x) : v(splat(static_cast<double>(x))) {}
};

INLINE vec operator-(vec x) { return {-x.a, -x.b}; }
INLINE lane operator-(lane x) { return -x.v; }
INLINE lane operator+(lane x) { return x; }

#define BOTH(operation)                                                                               \
  INLINE vec operator operation(vec x, vec y) { return {x.a operation y.a, x.b operation y.b}; }      \
  INLINE lane operator operation(lane x, lane y) { return x.v operation y.v; }
BOTH(+) BOTH(-) BOTH(*) BOTH(/)

#define OF_LANES(operation)                                                                           \
  INLINE lane operator operation(lane x, lane y) {                                                    \
    return vec{(::lane(x.v.a) operation ::lane(y.v.a)).v, (::lane(x.v.b) operation ::lane(y.v.b)).v}; \
  }
OF_LANES(<) OF_LANES(<=) OF_LANES(>) OF_LANES(>=) OF_LANES(==) OF_LANES(!=) OF_LANES(&&) OF_LANES(||)
INLINE lane operator!(lane x) { return vec{(!::lane(x.v.a)).v, (!::lane(x.v.b)).v}; }

#define OF_ONE(name) \
  INLINE lane name(lane x) { return vec{::name(::lane(x.v.a)).v, ::name(::lane(x.v.b)).v}; }
OF_ONE(fabs) OF_ONE(sign) OF_ONE(sq) OF_ONE(sqrt) OF_ONE(floor) OF_ONE(ceil) OF_ONE(exp) OF_ONE(log)
OF_ONE(sin) OF_ONE(cos) OF_ONE(tan) OF_ONE(asin) OF_ONE(acos) OF_ONE(atan)
OF_ONE(sinh) OF_ONE(cosh) OF_ONE(tanh) OF_ONE(asinh) OF_ONE(acosh) OF_ONE(atanh)
OF_ONE(erf) OF_ONE(expm1) OF_ONE(log1p)

#define OF_TWO(name)                                                                                  \
  INLINE lane name(lane x, lane y) {                                                                  \
    return vec{::name(::lane(x.v.a), ::lane(y.v.a)).v, ::name(::lane(x.v.b), ::lane(y.v.b)).v};       \
  }
OF_TWO(fmin) OF_TWO(fmax) OF_TWO(copysign) OF_TWO(atan2) OF_TWO(pow) OF_TWO(fmod) OF_TWO(remainder) OF_TWO(hypot)

INLINE lane select(lane condition, lane x, lane y) {
  return vec{::select(condition.v.a, x.v.a, y.v.a).v, ::select(condition.v.b, x.v.b, y.v.b).v};
}
INLINE vec fma(vec x, vec y, vec z) { return {::fma(x.a, y.a, z.a), ::fma(x.b, y.b, z.b)}; }
INLINE vec fms(vec x, vec y, vec z) { return {::fms(x.a, y.a, z.a), ::fms(x.b, y.b, z.b)}; }
INLINE vec fnma(vec x, vec y, vec z) { return {::fnma(x.a, y.a, z.a), ::fnma(x.b, y.b, z.b)}; }
INLINE vec shared_quotient(vec x, vec y) { return {::shared_quotient(x.a, y.a), ::shared_quotient(x.b, y.b)}; }

}  // namespace paired
