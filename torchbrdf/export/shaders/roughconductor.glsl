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
    return specular * (facets * visibility * metal_fresnel(eta, k, p.cos_d));
}
