// The radial functions of dc_kernels.sph.smoothing: w, f, g and k of each smoothing kernel at vectors of q2 = q^2 <= 1.
// Macros: COINCIDENT, RATE (of the Gaussian, exp(-RATE q^2 / 2)), TAYLOR (degree of its polynomial).
#if !defined(__CUDA_ARCH__)
auto square_root = [](const Vector q2) -> Vector { return __builtin_elementwise_sqrt(q2); };
// what is divided by, and what is singular where a neighbour lies at the place of the query, and counts as 0 there
auto divisor = [&](const Vector q) -> Vector { return __builtin_elementwise_max(q, zero + (Real)COINCIDENT); };
auto apart = [&](const Vector q, const Vector value) -> Vector { return q < (Real)COINCIDENT ? zero : value; };

auto poly6_w = [&](const Vector q2) -> Vector {
    const Vector s = 1 - q2;
    return s * s * s;
};
auto poly6_f = [&](const Vector q2) -> Vector {
    const Vector s = 1 - q2;
    return -6 * s * s;
};
auto poly6_g = [&](const Vector q2) -> Vector {
    const Vector s = 1 - q2;
    return 24 * s;
};
auto poly6_k = [&](const Vector q2) -> Vector { return zero - 48; };

// (1 - q)^3 for q > 0, which the outer part of the cubic spline is twice of
auto cone_w = [&](const Vector q) -> Vector {
    const Vector t = 1 - q;
    return t * t * t;
};
auto cone_f = [&](const Vector q, const Vector p) -> Vector {
    const Vector t = 1 - q;
    return -3 * t * t / p;
};
auto cone_g = [&](const Vector q, const Vector p) -> Vector {
    const Vector t = 1 - q;
    return 3 * t * (1 + q) / (p * p * p);
};
auto cone_k = [&](const Vector q2, const Vector p) -> Vector { return 3 * (q2 - 3) / (p * p * p * p * p); };

auto spiky_w = [&](const Vector q2) -> Vector { return cone_w(square_root(q2)); };
auto spiky_f = [&](const Vector q2) -> Vector {
    const Vector q = square_root(q2);
    return apart(q, cone_f(q, divisor(q)));
};
auto spiky_g = [&](const Vector q2) -> Vector {
    const Vector q = square_root(q2);
    return apart(q, cone_g(q, divisor(q)));
};
auto spiky_k = [&](const Vector q2) -> Vector {
    const Vector q = square_root(q2);
    return apart(q, cone_k(q2, divisor(q)));
};

// exp(x), x in [-RATE / 2, 0], as the sixteenth power of a Taylor polynomial of exp(x / 16)
auto gaussian_w = [&](const Vector q2) -> Vector {
    const Vector x = q2 * (Real)(-RATE / 32);
    Vector e = 1 + x * (Real)(1.0 / TAYLOR);
#pragma clang loop unroll(full)
    for (int n = TAYLOR - 1; n > 0; --n) e = 1 + e * (x * (Real)(1.0 / n));
    e *= e;
    e *= e;
    e *= e;
    e *= e;
    return e;
};
auto gaussian_f = [&](const Vector q2) -> Vector { return gaussian_w(q2) * (Real)-RATE; };
auto gaussian_g = [&](const Vector q2) -> Vector { return gaussian_w(q2) * (Real)(RATE * RATE); };
auto gaussian_k = [&](const Vector q2) -> Vector { return gaussian_w(q2) * (Real) - (RATE * RATE * RATE); };

auto cubic_w = [&](const Vector q2) -> Vector {
    const Vector q = square_root(q2);
    return q <= (Real)0.5 ? Vector(6 * q2 * (q - 1) + 1) : Vector(2 * cone_w(q));
};
auto cubic_f = [&](const Vector q2) -> Vector {
    const Vector q = square_root(q2);
    return q <= (Real)0.5 ? Vector(18 * q - 12) : Vector(2 * cone_f(q, divisor(q)));
};
auto cubic_g = [&](const Vector q2) -> Vector {
    const Vector q = square_root(q2), p = divisor(q);
    return apart(q, q <= (Real)0.5 ? Vector(18 / p) : Vector(2 * cone_g(q, p)));
};
auto cubic_k = [&](const Vector q2) -> Vector {
    const Vector q = square_root(q2), p = divisor(q);
    return apart(q, q <= (Real)0.5 ? Vector(-18 / (p * p * p)) : Vector(2 * cone_k(q2, p)));
};

auto wendland_w = [&](const Vector q2) -> Vector {
    const Vector q = square_root(q2), t = 1 - q;
    return (t * t) * (t * t) * (1 + 4 * q);
};
auto wendland_f = [&](const Vector q2) -> Vector {
    const Vector t = 1 - square_root(q2);
    return -20 * t * t * t;
};
auto wendland_g = [&](const Vector q2) -> Vector {
    const Vector q = square_root(q2), t = 1 - q;
    return apart(q, 60 * t * t / divisor(q));
};
auto wendland_k = [&](const Vector q2) -> Vector {
    const Vector q = square_root(q2), t = 1 - q, p = divisor(q);
    return apart(q, -60 * t * (1 + q) / (p * p * p));
};
#endif
