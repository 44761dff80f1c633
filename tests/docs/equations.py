r"""The central equation of every component in standard notation, for docs/components.

The docstrings write the same in ASCII, because `rmpc-bench describe` shows them in a terminal.  Time is an index here:
x_k is x(k).  Code hosts take a backslash before punctuation for Markdown: \lbrace, no \{, and no \, here.
"""

from __future__ import annotations

_SERVO = r"""J_l \ddot\theta_l = \rho T_s - \beta_l \dot\theta_l - T_{fl}, \quad
J_m \ddot\theta_m = K_t I - T_s - \beta_m \dot\theta_m - T_{fm}, \quad
T_s = \frac{k_\theta}{\rho} \left( \frac{\theta_m}{\rho} - \theta_l \right)"""
_UNCERTAIN = r"""x_{k+1} = (A + H_A F_x G_x) x_k + B u_k + (B_w + H_{Bw} F_w G_w) w_k
+ (B_v + H_{Bv} F_v G_v) v_k, \quad y_k = (C + H_C F_x G_x) x_k
+ (D_w + H_{Dw} F_w G_w) w_k + (D_v + H_{Dv} F_v G_v) v_k"""
_PREDICTOR = r"\hat x_{k+1|k} = \Phi_k \hat x_{k|k-1} + B u_k + K_k (y_k - C \hat x_{k|k-1})"
_GAIN = r"L_k = P_{k|k-1} C^\top (C P_{k|k-1} C^\top + R_v)^{-1}"
_ROBUST_GAIN = r"L_k = V_k C^\top (C V_k C^\top + R_v)^{-1}, \quad V_k = (P_{k|k-1}^{-1} - \theta_k I)^{-1}"
_COST = r"\sum_{t=k}^{k+N-1} x_{t+1}^\top Q_x x_{t+1} + u_t^\top R_u u_t"

EQUATIONS: dict[tuple[str, str], str] = {
    ("plants", "casadi"): r"""\dot x = f(t, x, z, u_k, p), \quad 0 = g(t, x, z, u_k, p), \quad
x_{k+1} = x((k+1) T_s) + w_k, \quad y_k = h(x_k, p) + v_k""",
    ("plants", "control"): r"""\dot x = f(t, x, u_k, p), \quad y_k = h(x_k, p); \quad \mathrm{linear:} \quad
x_{k+1} = e^{A T_s} x_k + \int_0^{T_s} e^{A s} ds B u_k + w_k, \quad y_k = C x_k + v_k""",
    ("plants", "scipy"): r"""\dot x = A x + B u_k: \quad
x_{k+1} = e^{A T_s} x_k + \int_0^{T_s} e^{A s} ds B u_k + w_k, \quad y_k = C x_k + v_k""",
    ("plants", "linear"): r"x_{k+1} = A_k x_k + B_k u_k + w_k, \quad y_k = C_k x_k + v_k",
    ("plants", "moving-slide"): r"M(y) \ddot y + N(y, \dot y) \dot y = J(y)^\top \tau",
    ("plants", "ode"): r"""\dot x = f(t, x, u_k, p), \quad k T_s \le t \lt (k + 1) T_s, \quad
x_{k+1} = x((k+1) T_s) + w_k, \quad y_k = h(x_k, p) + v_k""",
    ("plants", "servo"): _SERVO
    + r""", \quad L \dot I = V - R I - K_t \dot\theta_m, \quad
T_f(\omega) = (\alpha_0 + \alpha_1 e^{-\alpha_2 |\omega|}) \mathrm{sgn}(\omega)""",
    ("plants", "servo-linear"): _SERVO + r", \quad T_{fl} = T_{fm} = 0, \quad R I = V - K_t \dot\theta_m",
    ("plants", "uncertain-linear"): _UNCERTAIN,
    ("models", "control"): r"\dot x = f(x, u, p), \quad y = h(x, p); \quad \mathrm{linear:} \quad \dot x = A x + B u",
    ("models", "scipy"): r"x_{k+1} = e^{A T_s} x_k + \int_0^{T_s} e^{A s} ds B u_k + w_k, \quad y_k = C x_k + v_k",
    ("models", "linear"): r"""x_{k+1} = A_k x_k + B_k u_k + w_k, \quad y_k = C_k x_k + v_k, \quad
w_k = \bar w + w_k^s + w_k^b, \quad w_k^s \sim \mathcal{N}(0, P_w), \quad w_k^{b \top} M_w^{-1} w_k^b \le 1""",
    ("models", "linearise"): r"""\dot x = f(x_{op}, u_{op}) + A_c (x - x_{op}) + B_c (u - u_{op}), \quad
x_{k+1} = A x_k + B u_k + f_0 + w_k, \quad y_k = C x_k + d_0 + v_k""",
    ("models", "moving-slide"): r"\ddot y = -M(y)^{-1} N(y, \dot y) \dot y + M(y)^{-1} J(y)^\top \tau",
    ("models", "nonlinear"): r"x_{k+1} = f(x_k, u_k) + w_k, \quad y_k = h(x_k) + v_k",
    ("models", "ode"): r"\dot x = f(x, u, p), \quad y = h(x, p)",
    ("models", "servo"): _SERVO
    + r""", \quad L \dot I = V - R I - K_t \dot\theta_m, \quad
T_f(\omega) = (\alpha_0 + \alpha_1 e^{-\alpha_2 |\omega|}) \mathrm{sgn}(\omega)""",
    ("models", "servo-linear"): _SERVO + r", \quad T_{fl} = T_{fm} = 0, \quad R I = V - K_t \dot\theta_m",
    ("models", "uncertain-linear"): _UNCERTAIN,
    (
        "estimators",
        "oracle",
    ): r"""\hat x_{k+1|k} = A_k^F \hat x_{k|k-1} + B u_k + K_k (y_k - C_k^F \hat x_{k|k-1}), \quad
A_k^F = A + H_A F_x(k) G_x""",
    ("estimators", "kalman"): r"\hat x_{k|k} = \hat x_{k|k-1} + L_k (y_k - C \hat x_{k|k-1}), \quad"
    + "\n"
    + _GAIN
    + r", \quad P_{k+1|k} = A (I - L_k C) P_{k|k-1} A^\top + Q_w",
    ("estimators", "directional-kalman"): _GAIN
    + r""", \quad
P_{k+1|k} = A P_{k|k} A^\top + Q_w + q H_A H_A^\top""",
    ("estimators", "fading-kalman"): _GAIN
    + r""", \quad
P_{k+1|k} = \alpha^2 A P_{k|k} A^\top + Q_w""",
    ("estimators", "wasserstein-kalman"): r"""\max_S \mathrm{tr} (S_{xx} - S_{xy} S_{yy}^{-1} S_{yx})
\quad \mathrm{with} \quad \mathrm{tr} \left( S + \Sigma - 2 (\Sigma^{1/2} S \Sigma^{1/2})^{1/2} \right)
\le \rho^2, \quad L_k = S_{xy} S_{yy}^{-1}""",
    ("estimators", "h-infinity"): r"""P_{k+1|k} = A (P_{k|k-1}^{-1} - \theta W + C^\top R_v^{-1} C)^{-1} A^\top
+ Q_w, \quad \theta = 1 / \gamma^2""",
    ("estimators", "student-kalman"): r"""\lambda = \frac{\nu + n_y}{\nu + r^\top R_v^{-1} r +
\mathrm{tr} (R_v^{-1} C P_{k|k} C^\top)}, \quad r = y_k - C \hat x_{k|k}, \quad R_v \to R_v / \lambda""",
    ("estimators", "huber-kalman"): r"""\hat x_{k|k} = \arg \min_x \frac{1}{2} (x - \hat x_{k|k-1})^\top
P_{k|k-1}^{-1} (x - \hat x_{k|k-1}) + \sum_j \rho_k \left( (R_v^{-1/2} (y_k - C x))_j \right)""",
    ("estimators", "correntropy-kalman"): r"""R_v \to T \mathrm{diag}(w_j)^{-1} T^\top, \quad
w_j = \exp \left( - \frac{r_j^2}{2 \sigma^2} \right), \quad r = T^{-1} (y_k - C \hat x_{k|k}), \quad T T^\top = R_v""",
    ("estimators", "gated-kalman"): r"""\hat x_{k|k} = \hat x_{k|k-1} + L_k e_k \quad \mathrm{if} \quad
e_k^\top S_k^{-1} e_k \le g, \quad \mathrm{else} \quad \hat x_{k|k} = \hat x_{k|k-1}""",
    ("estimators", "moving-horizon"): r"""\min \Vert x_{k-N} - \bar x \Vert^2_{\bar P^{-1}}
+ \sum_j \Vert w_j \Vert^2_{Q_w^{-1}} + \sum_j \Vert y_j - C x_j \Vert^2_{R_v^{-1}}, \quad
w_j \in [\underline w, \overline w], \quad v_j \in [\underline v, \overline v], \quad
x_j \in [\underline x, \overline x]""",
    ("estimators", "nonlinear-moving-horizon"): r"""\min \Vert x_{k-N} - \bar x \Vert^2_{\bar P^{-1}}
+ \sum_j \Vert x_{j+1} - f(x_j, u_j) \Vert^2_{Q_w^{-1}} + \sum_j \Vert y_j - h(x_j) \Vert^2_{R_v^{-1}}, \quad
x_j \in [\underline x, \overline x]""",
    ("estimators", "control-lqe"): r"\hat x_{k|k} = \hat x_{k|k-1} + L (y_k - C \hat x_{k|k-1}), \quad"
    + "\n"
    + r"P = A (I - L C) P A^\top + Q_w, \quad L = P C^\top (C P C^\top + R_v)^{-1}",
    ("estimators", "extended-kalman"): r"""\hat x_{k+1|k} = f(\hat x_{k|k}, u_k), \quad
P_{k+1|k} = J P_{k|k} J^\top + Q_w, \quad J = \frac{\partial f}{\partial x}(\hat x_{k|k}, u_k)""",
    ("estimators", "unscented-kalman"): r"""\chi_i = \hat x \pm \sqrt{(n + \lambda) P}_i, \quad
\hat x_{k+1|k} = \sum_i W_i f(\chi_i, u_k), \quad
P_{k+1|k} = \sum_i W_i^c (f(\chi_i, u_k) - \hat x_{k+1|k}) (\cdot)^\top + Q_w, \quad
L_k = P_{xy} (P_{yy} + R_v)^{-1}""",
    ("estimators", "robust-kalman"): _ROBUST_GAIN
    + r""", \quad
\log \det (I - \theta_k P_{k|k-1}) + \mathrm{tr} \left[ (I - \theta_k P_{k|k-1})^{-1} - I \right] = c""",
    ("estimators", "risk-sensitive"): _ROBUST_GAIN + r", \quad \theta_k = \theta",
    (
        "estimators",
        "kalman-predictor",
    ): r"""\hat x_{k+1|k} = A \hat x_{k|k-1} + B u_k + K_k (y_k - C \hat x_{k|k-1}), \quad
K_k = (A P_{k|k-1} C^\top + S_{wv}) (C P_{k|k-1} C^\top + R_v)^{-1}""",
    ("estimators", "enhanced-robust"): _PREDICTOR + r", \quad \mathrm{cov}(\hat x_{k|k-1} - x_k) \le P_k",
    ("estimators", "sayed-bdu"): r"""\min_{x, w} \max_{\Vert \Delta \Vert \le 1}
\Vert x - \hat x_k \Vert_{P_k^{-1}}^2 + \Vert w \Vert_{Q_w^{-1}}^2
+ \Vert y_{k+1} - C x_{k+1}(x, w, \Delta) \Vert_{R^{-1}}^2""",
    ("estimators", "robust-h-infinity"): r"""\mathrm{E} (\hat x_k - x_k) (\hat x_k - x_k)^\top \le P_k
\quad \mathrm{for\ all\ } F_k^\top F_k \le I""",
    ("estimators", "lmmse"): r"""\hat x_{k+1|k} = \bar A \hat x_{k|k-1} + B u_k + K_k e_k, \quad
K_k = \mathrm{cov}(x_{k+1}, e_k) \mathrm{cov}(e_k)^{-1}""",
    ("estimators", "lp-window"): r"""\min \sum_i \rho_i + \sum_j r_j, \quad
-\rho \le x_{\kappa+1} - A x_\kappa - B u_\kappa \le \rho, \quad -r \le y_\kappa - C x_\kappa \le r""",
    ("estimators", "mixed"): r"""P_{k|k} = T P_{k|k-1} T^\top + L_k P_v L_k^\top, \quad
M_{k|k} = (q_k^{-1} + 1) T M_{k|k-1} T^\top + (q_k + 1) L_k M_v L_k^\top, \quad T = I - L_k C""",
    ("estimators", "set-membership"): r"""(\hat x_k - x_k)^\top M_k^{-1} (\hat x_k - x_k) \le 1, \quad
M_{k|k} = (q_k^{-1} + 1) T M_{k|k-1} T^\top + (q_k + 1) L_k M_v L_k^\top, \quad T = I - L_k C""",
    ("estimators", "kalman-disturbance"): r"""x_{k+1} = A x_k + B u_k + f_0 + d_k + w_k, \quad d_{k+1} = d_k + \xi_k,
\quad \xi_k \sim \mathcal{N}(0, q I)""",
    ("controllers", "gpc"): r"""\min \sum_{j=1}^{N_p} \Vert Q_{yw} (\hat y_{k+j} - r_{k+j}) \Vert^2
+ \Vert Q_u u_{k+j-1} \Vert^2""",
    ("controllers", "mpc"): r"""\min \sum_{j=1}^{H_p} \Vert \hat y_{k+j} - r_{k+j} \Vert_Q^2
+ \sum_{j=0}^{H_u - 1} \Vert \Delta u_{k+j} \Vert_R^2""",
    ("controllers", "minimax-lq"): r"\min_u \max_{e, w^b} \mathrm{E} " + _COST,
    ("controllers", "lqr"): r"\min_u " + _COST,
    ("controllers", "tube-mpc"): r"""\min \sum_{j=0}^{N-1} \Vert z_j \Vert_{Q_x}^2 + \Vert v_j \Vert_{R_u}^2
+ \Vert z_N \Vert_P^2, \quad z_0 \in x_k - Z, \quad u_k = v_0 + K (x_k - z_0)""",
    ("controllers", "control-lqr"): r"\min_u \sum_{k=0}^{\infty} x_k^\top Q_x x_k + u_k^\top R_u u_k",
    ("controllers", "game-gain"): r"\min_u \max_w " + _COST + r" - \tau w_t^\top M_w^{-1} w_t",
    (
        "controllers",
        "lqg",
    ): r"""u_k = u_s - K_x (\hat x_k - x_s) - K_q (q_k - q_s), \quad q_{k+1} = q_k + y_k - r_k, \quad
\min_u \sum_{k=0}^{\infty} x_k^\top Q_x x_k + q_k^\top Q_i q_k + u_k^\top R_u u_k""",
    (
        "controllers",
        "pid",
    ): r"""u = u_{op} + K_p (b r - y) + \frac{K_i}{s} (r - y) + \frac{K_d s}{1 + T_f s} (c r - y)""",
    ("references", "constant"): r"r_k = \mathrm{value}",
    ("references", "s-shape"): r"""x = -w \sin 2f, \quad y = h \cos f, \quad \psi = \alpha \sin^2 (\pi g), \quad
f = \left( \tfrac{5}{4} g - \tfrac{1}{8} \right) \pi, \quad g = 10 s^3 - 15 s^4 + 6 s^5, \quad s = \min(t / T, 1)""",
    ("references", "square"): r"""r_k = v_1 \quad \mathrm{if\ } (k T_s \bmod T) \lt d T, \quad
r_k = v_2 \quad \mathrm{otherwise}""",
    (
        "inputs",
        "prbs",
    ): r"u_k = \mathrm{low} + (\mathrm{high} - \mathrm{low}) b_{\lfloor k / n \rfloor}, \quad b = 0, 1",
    ("inputs", "sine"): r"u_k = \bar u + a \sin \left( 2 \pi k T_s / T + \varphi \right)",
    ("inputs", "steps"): r"u_k = v_i \quad \mathrm{for\ } t_i \le k T_s \lt t_{i+1}",
    ("noises", "student-t"): r"w = \bar w + s z \sqrt{\nu / \chi^2_\nu}, \quad z \sim \mathcal{N}(0, I)",
    ("noises", "outliers"): r"""w = \bar w + f^b z, \quad z \sim \mathcal{N}(0, s^2 \Sigma), \quad
b \sim \mathrm{Bernoulli}(p)""",
    ("noises", "half-normal"): r"w = c + s |z|, \quad z \sim \mathcal{N}(0, I)",
    ("noises", "drift"): r"w_{k+1} = w_k + s z_k, \quad z_k \sim \mathcal{N}(0, \Sigma)",
    ("noises", "coloured"): r"""w_{k+1} = a w_k + \sqrt{1 - a^2} s z_k, \quad z_k \sim \mathcal{N}(0, \Sigma), \quad
a = e^{-T_s / \tau}""",
    ("noises", "quantised"): r"y = o + q \mathrm{round} \left( \frac{y - o}{q} \right)",
    ("noises", "delayed"): r"y_j \ \mathrm{arrives\ at\ } k = j + d_j, \quad 0 \le d_j \le D",
    ("noises", "missing"): r"P(y_k \ \mathrm{is\ missing}) = p",
    ("noises", "corners"): r"w = c + \mathrm{diag}(\rho) u, \quad u_i = \pm 1",
    ("noises", "ellipsoid"): r"w = c + s L u, \quad L L^\top = M, \quad (w - c)^\top M^{-1} (w - c) \le s^2",
    ("noises", "gaussian"): r"w \sim \mathcal{N}(\bar w, s^2 \Sigma)",
    ("noises", "uniform"): r"w = c + T \mathrm{diag}(\rho) u, \quad u_i \sim \mathcal{U}(-1, 1)",
    ("metrics", "mse"): r"\frac{1}{N n_y} \sum_{k=0}^{N-1} \Vert y_k - r_k \Vert^2",
    ("metrics", "mae"): r"\frac{1}{N n_y} \sum_{k=0}^{N-1} \sum_i |y_{k,i} - r_{k,i}|",
    ("metrics", "rmse"): r"\sqrt{\frac{1}{N n_y} \sum_{k=0}^{N-1} \Vert y_k - r_k \Vert^2}",
    ("metrics", "iae"): r"\frac{T_s}{n_y} \sum_{k=0}^{N-1} \sum_i |y_{k,i} - r_{k,i}|",
    ("metrics", "input_power"): r"\frac{1}{N n_u} \sum_{k=0}^{N-1} \Vert u_k \Vert^2",
    ("metrics", "input_roughness"): r"""\sqrt{\frac{1}{n_u} \sum_i \mathrm{var}_k (\Delta u_{k,i})}, \quad
\Delta u_k = u_k - u_{k-1}""",
    (
        "metrics",
        "settling_time",
    ): r"""T_s \min \left\lbrace m : |y_{k,i} - r_{k,i}| \le \mathrm{band} \cdot \mathrm{step}_i
\quad \mathrm{for\ all\ } i, k \ge m \right\rbrace""",
    ("metrics", "steady_state_error"): r"\frac{1}{n n_y} \sum_{k \gt N-n} \sum_i (y_{k,i} - r_{k,i})",
    ("metrics", "estimation_mse"): r"\frac{1}{N n_x} \sum_{k=0}^{N-1} \Vert \hat x_k - x_k \Vert^2",
    ("metrics", "nees"): r"\frac{1}{N n_x} \sum_{k=0}^{N-1} (\hat x_k - x_k)^\top P_k^{-1} (\hat x_k - x_k)",
    ("metrics", "coverage"): r"""\frac{1}{N} \sum_{k=0}^{N-1} \mathbf{1} \left\lbrace
(\hat x_k - x_k)^\top P_k^{+} (\hat x_k - x_k) \le \chi^2_{\mathrm{rank} P_k}(p) \right\rbrace""",
    ("metrics", "crps"): r"""\frac{1}{N} \sum_{k=0}^{N-1} \sigma_k \left( z_k (2 \Phi(z_k) - 1) + 2 \varphi(z_k)
- \frac{1}{\sqrt{\pi}} \right), \quad z_k = \frac{\hat x_{k,i} - x_{k,i}}{\sigma_k}, \quad \sigma_k^2 = P_{k,ii}""",
    ("metrics", "log_score"): r"""\frac{1}{2 N} \sum_{k=0}^{N-1} \left( n_x \log 2 \pi
+ (\hat x_k - x_k)^\top P_k^{-1} (\hat x_k - x_k) + \log \det P_k \right)""",
    ("metrics", "nis"): r"\frac{1}{(N+1) n_y} \sum_{k=0}^{N} e_k^\top S_k^{-1} e_k",
    ("metrics", "innovation_mse"): r"\frac{1}{(N+1) n_y} \sum_{k=0}^{N} \Vert e_k \Vert^2",
    ("metrics", "whiteness"): r"""\frac{n^2}{m n_y^2} \sum_{j=1}^{m}
\frac{\mathrm{tr} (C_j^\top C_0^{-1} C_j C_0^{-1})}{n - j}, \quad
C_j = \frac{1}{n} \sum_k (e_k - \bar e) (e_{k-j} - \bar e)^\top""",
    (
        "metrics",
        "inside",
    ): r"""\frac{1}{N} \mathrm{number\ of\ } \left\lbrace k \lt N :
(x_k - \hat x_k)^\top S_k^{-1} (x_k - \hat x_k) \le 1
\right\rbrace""",
    ("metrics", "cost"): r"\sum_{k=0}^{N-1} x_{k+1}^\top Q_x x_{k+1} + u_k^\top R_u u_k",
    ("metrics", "certificate"): r"\frac{J_{worst}}{\rho}",
    ("metrics", "tracking"): r"\sqrt{\frac{1}{n p} \sum_k \sum_i (r_{k,i} - y_{k,i})^2} \quad (\mathrm{norm: rms})",
    (
        "metrics",
        "departures",
    ): r"\mathrm{number\ of\ } \left\lbrace k : \max_i |e_{k,i}| \gt s e_{rms} \mathrm{\ begins\ at\ } k \right\rbrace",
    ("metrics", "violation"): r"""\frac{1}{N} |\lbrace k \lt N : e_k \gt 0 \rbrace|, \quad \max_k e_k, \quad
T_s \sum_k e_k, \quad e_k = \max_i \max(z_{min} - z_{k,i}, z_{k,i} - z_{max}, 0)""",
    ("metrics", "largest"): r"\max_{k \lt N, i} |z_{k,i}|",
    ("metrics", "runaway"): r"1 \mathrm{\ if\ } \max_k |y_{k,i}| \gt f \max_k |r_{k,i}|, \mathrm{\ else\ } 0",
    ("metrics", "qp_share"): r"\frac{1}{N} |\lbrace k \lt N : \mathrm{result}_k = \mathrm{of} \rbrace|",
    ("metrics", "input_variation"): r"\frac{1}{N-1} \sum_{k=1}^{N-1} \sum_i |u_{k,i} - u_{k-1,i}|",
    ("metrics", "input_rms"): r"\sqrt{\frac{1}{N n_u} \sum_{k=0}^{N-1} \Vert u_k \Vert^2}",
    ("metrics", "input_peak"): r"\max_{k \lt N, i} |u_{k,i}|",
    (
        "metrics",
        "near_singular",
    ): r"\mathrm{number\ of\ } \left\lbrace k \lt N : \sigma_{\min} (J(y_k)) \lt b \right\rbrace",
}
"""(group, kind) -> LaTeX."""

IN_WORDS = {
    ("plants", "data"),
    ("plants", "fmu"),
    ("plants", "env"),
    ("inputs", "file"),
    ("metrics", "sample"),
    ("metrics", "reported"),
    ("metrics", "fallbacks"),
}
"""Components that words define."""
