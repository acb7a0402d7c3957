// Fresnel's reflectance of unpolarized light for a real index of refraction
float abc_dielectric(float ior, float cos_d)
{
    float excess = (ior - 1.0) * (ior + 1.0), total = sqrt(excess + cos_d * cos_d) + cos_d, less = excess / total;
    float a = less / total, b = (cos_d * total - 1.0) / (cos_d * less + 1.0);
    return 0.5 * a * a * (1.0 + b * b);
}

vec3 abc(Pair p, vec3 amplitude, float sharpness, float exponent, float ior)
{
    float facets = exp(-exponent * log1p(sharpness * one_minus_cos_h(p))) * v_groove(p) / PI;
    return amplitude * (facets * abc_dielectric(ior, p.cos_d));
}
