vec3 oren_nayar(Pair p, vec3 albedo, float roughness)
{
    float s2 = roughness * roughness, horizontal = 2.0 * square(p.cos_d) - 1.0 - p.cos_i * p.cos_o;
    float grooves = max(horizontal, 0.0) / max(p.cos_i, p.cos_o);
    return albedo / PI * (1.0 - 0.5 * s2 / (s2 + 0.33) + 0.45 * s2 / (s2 + 0.09) * grooves);
}
