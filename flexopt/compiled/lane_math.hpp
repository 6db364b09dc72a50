// Elementary functions of lanes: sin, cos, tan, exp, log, atan, atan2, asin, acos.
//
// Polynomials are those of fdlibm and Cephes, errors at most 2 ulp (tan, asin, acos, atan2: 4); arguments outside their
// range go to the C library, point by point.

typedef unsigned long long bits __attribute__((vector_size(8 * LANES)));

#define SLOW(name)                                                                            \
  static __attribute__((noinline, cold)) vec slow_##name(vec x, vec fast, mask wrong) {       \
    for (int k = 0; k < LANES; ++k)                                                           \
      if (wrong[k]) fast[k] = __builtin_##name(x[k]);                                         \
    return fast;                                                                              \
  }
#define SLOW_2(name)                                                                          \
  static __attribute__((noinline, cold)) vec slow_##name(vec y, vec x, vec fast, mask wrong) { \
    for (int k = 0; k < LANES; ++k)                                                           \
      if (wrong[k]) fast[k] = __builtin_##name(y[k], x[k]);                                   \
    return fast;                                                                              \
  }
SLOW(sin) SLOW(cos) SLOW(tan) SLOW_2(atan2)

// x = n π/2 + high + low, |high| ≤ π/4. π/2 in four parts: n times each of the first three is exact for |n| < 2^20.
struct reduced {
  vec high, low;
  mask quadrant;
};

const double MAGIC = 6755399441055744.0;  // 1.5 · 2^52: adding it leaves the nearest integer in the low bits

INLINE reduced reduce(vec x) {
  vec shifted = x * splat(0.63661977236758134308) + splat(MAGIC);
  vec n = shifted - splat(MAGIC);
  vec t = x - n * splat(1.57079632673412561417e+00);
  vec u = n * splat(6.07710050630396597660e-11);
  vec r = t - u;
  vec back = t - r;
  vec tail = (t - (r + back)) + (back - u);
  tail -= n * splat(2.02226624871116645580e-21);
  tail -= n * splat(8.47842766036889956997e-32);
  vec high = r + tail;
  return {high, (r - high) + tail, (mask)shifted};
}

INLINE vec sine_kernel(vec x, vec y) {
  vec z = x * x, v = z * x;
  vec r = splat(1.58969099521155010221e-10);
  r = r * z + splat(-2.50507602534068634195e-08);
  r = r * z + splat(2.75573137070700676789e-06);
  r = r * z + splat(-1.98412698298579493134e-04);
  r = r * z + splat(8.33333333332248946124e-03);
  return x - ((z * (splat(0.5) * y - v * r) - y) - v * splat(-1.66666666666666324348e-01));
}

INLINE vec cosine_kernel(vec x, vec y) {
  vec z = x * x;
  vec r = splat(-1.13596475577881948265e-11);
  r = r * z + splat(2.08757232129817482790e-09);
  r = r * z + splat(-2.75573143513906633035e-07);
  r = r * z + splat(2.48015872894767294178e-05);
  r = r * z + splat(-1.38888888888741095749e-03);
  r = r * z + splat(4.16666666666666019037e-02);
  vec half = splat(0.5) * z, w = splat(1) - half;
  return w + (((splat(1) - w) - half) + (z * (z * r) - x * y));
}

INLINE mask odd(mask n) { return (n & 1) != 0; }
INLINE vec flipped(vec x, mask n) { return (vec)((mask)x ^ ((n & 2) << 62)); }
// NaN stays NaN on the fast way, and so costs nothing.
INLINE mask too_large(vec x) { return absolute(x) >= splat(1e5); }

INLINE lane sin(lane x) {
  reduced r = reduce(x.v);
  vec s = sine_kernel(r.high, r.low), c = cosine_kernel(r.high, r.low);
  vec result = flipped(pick(odd(r.quadrant), c, s), r.quadrant);
  result = pick(x.v == splat(0), x.v, result);
  mask wrong = too_large(x.v);
  if (__builtin_expect(any(wrong), 0)) return slow_sin(x.v, result, wrong);
  return result;
}

INLINE lane cos(lane x) {
  reduced r = reduce(x.v);
  vec s = sine_kernel(r.high, r.low), c = cosine_kernel(r.high, r.low);
  vec result = flipped(pick(odd(r.quadrant), s, c), r.quadrant + 1);
  mask wrong = too_large(x.v);
  if (__builtin_expect(any(wrong), 0)) return slow_cos(x.v, result, wrong);
  return result;
}

INLINE lane tan(lane x) {
  reduced r = reduce(x.v);
  vec s = sine_kernel(r.high, r.low), c = cosine_kernel(r.high, r.low);
  mask swap = odd(r.quadrant);
  vec result = pick(swap, -c, s) / pick(swap, s, c);
  result = pick(x.v == splat(0), x.v, result);
  mask wrong = too_large(x.v);
  if (__builtin_expect(any(wrong), 0)) return slow_tan(x.v, result, wrong);
  return result;
}

INLINE vec power_of_two(mask n) { return (vec)((n + 1023) << 52); }

INLINE lane exp(lane argument) {
  vec x = argument.v;
  x = pick(x > splat(710), splat(710), x);
  x = pick(x < splat(-746), splat(-746), x);
  vec shifted = x * splat(1.44269504088896340736) + splat(MAGIC);
  vec n = shifted - splat(MAGIC);
  vec r = (x - n * splat(6.93145751953125e-1)) - n * splat(1.42860682030941723212e-6);
  vec z = r * r;
  vec p = (splat(1.26177193074810590878e-4) * z + splat(3.02994407707441961300e-2)) * z + splat(9.99999999999999999910e-1);
  vec q = (splat(3.00198505138664455042e-6) * z + splat(2.52448340349684104192e-3)) * z;
  q = (q + splat(2.27265548208155028766e-1)) * z + splat(2.00000000000000000009e0);
  p *= r;
  vec result = splat(1) + splat(2) * (p / (q - p));
  // 2^n in two factors, so that neither leaves the range of a double where their product does not.
  mask whole_n = (mask)shifted - (mask)splat(MAGIC), half = whole_n >> 1;
  return result * power_of_two(half) * power_of_two(whole_n - half);
}

INLINE lane log(lane argument) {
  vec x = argument.v;
  mask tiny = x < splat(2.2250738585072014e-308);
  bits i = (bits)pick(tiny, x * splat(18014398509481984.0), x) + (0x3ff0000000000000ULL - 0x3fe6a09e00000000ULL);
  mask exponent = (mask)(i >> 52) - 0x3ff;
  vec k = (vec)(exponent + (mask)splat(MAGIC)) - splat(MAGIC) - pick(tiny, splat(54), splat(0));
  vec f = (vec)((i & 0x000fffffffffffffULL) + 0x3fe6a09e00000000ULL) - splat(1);
  vec s = f / (splat(2) + f), z = s * s, w = z * z;
  vec even = w * (splat(3.999999999940941908e-01) + w * (splat(2.222219843214978396e-01) + w * splat(1.531383769920937332e-01)));
  vec rest = w * (splat(1.818357216161805012e-01) + w * splat(1.479819860511658591e-01));
  vec unequal = z * (splat(6.666666666666735130e-01) + w * splat(2.857142874366239149e-01) + rest * w);
  vec half_square = splat(0.5) * f * f;
  vec result = s * (half_square + even + unequal) + k * splat(1.90821492927058770002e-10) - half_square + f +
               k * splat(6.93147180369123816490e-01);
  const vec infinite = splat(__builtin_inf());
  result = pick(x == infinite, infinite, pick(x > splat(0), result, splat(__builtin_nan(""))));
  return pick(x == splat(0), -infinite, result);
}

// Angle in [0, π/2] whose tangent is y / x, for y, x ≥ 0 not both 0, neither so large that their sum overflows.
INLINE vec first_quadrant(vec y, vec x) {
  mask steep = y > splat(2.41421356237309504880) * x, middle = ~steep & (y > splat(0.66) * x);
  vec t = pick(steep, -x, pick(middle, y - x, y)) / pick(steep, y, pick(middle, y + x, x));
  vec z = t * t;
  vec p = splat(-8.750608600031904122785e-1);
  p = p * z + splat(-1.615753718733365076637e1);
  p = p * z + splat(-7.500855792314704667340e1);
  p = p * z + splat(-1.228866684490136173410e2);
  p = p * z + splat(-6.485021904942025371773e1);
  vec q = z + splat(2.485846490142306297962e1);
  q = q * z + splat(1.650270098316988542046e2);
  q = q * z + splat(4.328810604912902668951e2);
  q = q * z + splat(4.853903996359136964868e2);
  q = q * z + splat(1.945506571482613964425e2);
  vec start = pick(steep, splat(1.57079632679489661923), pick(middle, splat(0.78539816339744830962), splat(0)));
  vec more = pick(steep, splat(6.123233995736765886130e-17), pick(middle, splat(3.061616997868382943065e-17), splat(0)));
  return start + (t + (t * (z * p / q) + more));
}

INLINE lane atan(lane x) {
  vec size = absolute(x.v);
  vec bounded = pick(size > splat(1e300), splat(1e300), size);
  return signed_like(first_quadrant(bounded, splat(1)), x.v);
}

INLINE lane atan2(lane y, lane x) {
  vec a = absolute(y.v), b = absolute(x.v), largest = pick(a > b, a, b);
  vec angle = first_quadrant(a, b);
  angle = pick(x.v < splat(0), splat(3.14159265358979323846) - (angle - splat(1.2246467991473531772e-16)), angle);
  vec result = signed_like(angle, y.v);
  mask wrong = ~((largest < splat(1e300)) & (largest > splat(1e-300)) & (a == a) & (b == b));
  if (__builtin_expect(any(wrong), 0)) return slow_atan2(y.v, x.v, result, wrong);
  return result;
}

INLINE lane asin(lane x) { return atan2(x, sqrt((1 - x) * (1 + x))); }
INLINE lane acos(lane x) { return atan2(sqrt((1 - x) * (1 + x)), x); }
