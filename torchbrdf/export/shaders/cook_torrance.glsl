vec3 cook_torrance(Pair p, vec3 specular, float roughness, float f0)
{
    float facets = beckmann_exponential(p, roughness) * v_groove(p) / (PI * square(roughness));
    return specular * (facets * schlick(f0, p.cos_d));
}
