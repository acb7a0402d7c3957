vec3 ggx_f82(Pair p, vec3 f0, vec3 f82, float roughness, float weight)
{
    float a2 = roughness * roughness, at82 = schlick_weight(1.0 / 7.0);
    float facets = square((1.0 + p.tan2_h) / (a2 + p.tan2_h)) * a2 / PI * ggx_visibility(p, roughness);
    // S at 82 degrees, where the reflectance is f82 times S
    vec3 there = f0 + (vec3(1.0) - f0) * at82;
    float dip = p.cos_d * (1.0 - p.cos_d) * schlick_weight(p.cos_d) / (6.0 / 49.0 * at82);
    vec3 fresnel = f0 + (vec3(1.0) - f0) * schlick_weight(p.cos_d) - (vec3(1.0) - f82) * there * dip;
    return fresnel * (weight * facets);
}
