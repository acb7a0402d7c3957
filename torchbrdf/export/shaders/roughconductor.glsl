// Fresnel's reflectance of unpolarized light for a metal
float roughconductor_fresnel(float eta, float k, float c)
{
    float c2 = c * c, s2 = 1.0 - c2, real = eta * eta - k * k - s2, imaginary = 2.0 * eta * k;
    float length2 = sqrt(real * real + imaginary * imaginary), larger = sqrt(0.5 * (length2 + abs(real)));
    float across_cos = 2.0 * c * (real > 0.0 ? larger : 0.5 * imaginary / larger);
    float across = (length2 + c2 - across_cos) / (length2 + c2 + across_cos);
    float sum = c2 * length2 + s2 * s2;
    return 0.5 * across * (1.0 + (sum - across_cos * s2) / (sum + across_cos * s2));
}

// 2 / (1 + sqrt(1 + a^2 tan^2)) / (2 cos), so that a product of two is G1 G1 / (4 cos_i cos_o)
float roughconductor_masked(float cosine, float a)
{
    float c = max(cosine, LEAST);
    return 1.0 / (c + sqrt(a * a + (1.0 - a * a) * c * c));
}

vec3 roughconductor(Pair p, vec3 specular, float roughness, float eta, float k)
{
    float a2 = roughness * roughness;
    float facets = square((1.0 + p.tan2_h) / (a2 + p.tan2_h)) * a2 / PI;
    float visibility = roughconductor_masked(p.cos_i, roughness) * roughconductor_masked(p.cos_o, roughness);
    return specular * (facets * visibility * roughconductor_fresnel(eta, k, p.cos_d));
}
