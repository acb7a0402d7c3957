// The complementary error function of 0 and above: Abramowitz and Stegun 7.1.26, to 1.5e-7.
float beckmann_erfc(float x)
{
    float t = 1.0 / (1.0 + 0.3275911 * x);
    float sum = 0.254829592 + t * (-0.284496736 + t * (1.421413741 + t * (-1.453152027 + t * 1.061405429)));
    return t * sum * exp(-x * x);
}

// cos Lambda
float beckmann_masked(float cosine, float m)
{
    float sine = sqrt(max(1.0 - cosine * cosine, 1e-12));
    float v = min(cosine / (m * sine), 9.0);
    return 0.5 * (exp(-v * v) * sine * m / sqrt(PI) - cosine * beckmann_erfc(v));
}

vec3 beckmann(Pair p, vec3 specular, float roughness, float f0)
{
    float i = max(p.cos_i, LEAST), o = max(p.cos_o, LEAST);
    float facets = beckmann_exponential(p, roughness) / (PI * square(roughness));
    float visibility = 0.25 / (i * o + i * beckmann_masked(o, roughness) + o * beckmann_masked(i, roughness));
    return specular * (facets * visibility * schlick(f0, p.cos_d));
}
