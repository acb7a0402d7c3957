vec3 roughconductor_anisotropic(
    Pair p, vec3 specular, float roughness_x, float roughness_y, float rotation, float eta, float k)
{
    vec2 a = vec2(roughness_x, roughness_y);
    float i = max(p.cos_i, LEAST), o = max(p.cos_o, LEAST);
    float s_i = grain_length(i, p.along_i, a, rotation), s_o = grain_length(o, p.along_o, a, rotation);
    float facets = grain_distribution(p, a, rotation) / ((i + s_i) * (o + s_o));
    return specular * (facets * metal_fresnel(eta, k, p.cos_d));
}
