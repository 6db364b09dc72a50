// The excavator's closed loop by hand: the equations, the machine's numbers and the scales of both programs.
//
// In absolute angles φ = (θ1, θ1 + θ2, θ1 + θ2 + θ3), with the base's position p eliminated, s_ij = A_ij − c_i c_j / m,
// e_k = (cos φ_k, sin φ_k) and F the force of the springs and dampers on the base,
//
//   Σ_j s_ij cos(φ_i − φ_j) φ̈_j + Σ_j s_ij sin(φ_i − φ_j) φ̇_j² = Q_i − (c_i / m) e_i × F,   m p̈ = F − Σ c_k ë_k.
//
// What makes it fast:
// - no trigonometry: the e_k are carried, and turned by small angles; sin and cos only every RESYNCHRONISE steps;
// - q̇ = v, so RK4 is q⁺ = q + h v + h²/6 (a₁ + a₂ + a₃): a stage's position waits for the last stage but one, and two
//   stages overlap. Stage positions differ from q + h v / 2 and q + h v by h² a / 4 and h² a / 2: a short series;
// - springs and dampers are linear: their forces at the start of the step are corrected, not evaluated, at each stage;
// - axes of x and y along the base at rest, and scales (below): no rotation, no multiplication by 1;
// - every constant is folded by the compiler.
//
// Exact to rounding while no body turns faster than 12 rad/s (0.06 rad a step) or accelerates by more than 20 rad/s²;
// beyond, the series lose digits gradually.

#define RESYNCHRONISE 100

// The controller and the step.
#define STEP 0.005
#define PROPORTIONAL 1e5
#define DERIVATIVE 2e3

// The machine (models/excavator.toml).
#define LB 0.541
#define L1 1.918
#define L2 1.097
#define MB 5291.5
#define M1 766.6
#define M2 458.2
#define KXY 4e7  // the same along x and y, which is used: the axes are turned by REST
#define KT 1.112e6
#define DXY 50.0
#define DT 25.0
#define REST 1.2451
#define MASS (MB + M1 + M2)
#define FIRST_1 (MB * 0.563 + (M1 + M2) * LB)  // c_k
#define FIRST_2 (M1 * 1.067 + M2 * L1)
#define FIRST_3 (M2 * 0.613)
#define S11 (1020.7 + MB * 0.563 * 0.563 + (M1 + M2) * LB * LB - FIRST_1 * FIRST_1 / MASS)
#define S22 (214.9 + M1 * 1.067 * 1.067 + M2 * L1 * L1 - FIRST_2 * FIRST_2 / MASS)
#define S33 (93.6 + M2 * 0.613 * 0.613 - FIRST_3 * FIRST_3 / MASS)
#define S12 (LB * FIRST_2 - FIRST_1 * FIRST_2 / MASS)
#define S13 (LB * FIRST_3 - FIRST_1 * FIRST_3 / MASS)
#define S23 (L1 * FIRST_3 - FIRST_2 * FIRST_3 / MASS)

// Scales: rates u_k = √σ_k φ̇_k and accelerations z_k = σ_k φ̈_k with σ_k = √s_kk, so that u̇_k = RATE_k z_k; positions
// μ p; e_k at the length κ_k, where κ_i κ_j = s_ij / (σ_i σ_j): products of two carried e_k are the entries of a matrix
// with a unit diagonal. This machine has s_12, s_13 < 0 < s_23, so κ_1 is negative.
#define ROOT(x) __builtin_sqrt(x)
#define SIGMA_1 ROOT(S11)
#define SIGMA_2 ROOT(S22)
#define SIGMA_3 ROOT(S33)
#define KAPPA_1 (-ROOT(S12 * S13 / S23) / SIGMA_1)
#define KAPPA_2 (ROOT(S12 * S23 / S13) / SIGMA_2)
#define KAPPA_3 (ROOT(S13 * S23 / S12) / SIGMA_3)
#define RATE_1 (1.0 / ROOT(SIGMA_1))  // φ̇_k = RATE_k u_k, u̇_k = RATE_k z_k
#define RATE_2 (1.0 / ROOT(SIGMA_2))
#define RATE_3 (1.0 / ROOT(SIGMA_3))
#define MU ROOT(MASS)
#define G1 (FIRST_1 / (MU * SIGMA_1 * KAPPA_1))
#define G2 (FIRST_2 / (MU * SIGMA_2 * KAPPA_2))
#define G3 (FIRST_3 / (MU * SIGMA_3 * KAPPA_3))

// The controller: lengths as carried, and the joint torques from the components of Jv⁻¹ f.
#define POSITION_1 (PROPORTIONAL * LB / KAPPA_1)
#define POSITION_2 (PROPORTIONAL * L1 / KAPPA_2)
#define POSITION_3 (PROPORTIONAL * L2 / KAPPA_3)
#define VELOCITY_1 (DERIVATIVE * LB * RATE_1 / KAPPA_1)
#define VELOCITY_2 (DERIVATIVE * L1 * RATE_2 / KAPPA_2)
#define VELOCITY_3 (DERIVATIVE * L2 * RATE_3 / KAPPA_3)
#define TO_ONE (-KAPPA_2 / (KAPPA_1 * L1))
#define TO_TWO (KAPPA_3 / (KAPPA_1 * L2))

#define INLINE static inline __attribute__((always_inline))
#define PUBLIC __attribute__((visibility("default")))
