vec3 ggx_anisotropic(Pair p, vec3 specular, float roughness_x, float roughness_y, float rotation, float f0)
{
    vec2 a = vec2(roughness_x, roughness_y);
    float i = max(p.cos_i, LEAST), o = max(p.cos_o, LEAST);
    float s_i = grain_length(i, p.along_i, a, rotation), s_o = grain_length(o, p.along_o, a, rotation);
    float visibility = 0.5 / (o * s_i + i * s_o);
    return specular * (grain_distribution(p, a, rotation) * visibility * schlick(f0, p.cos_d));
}
