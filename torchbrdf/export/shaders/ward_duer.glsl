vec3 ward_duer(Pair p, vec3 specular, float roughness)
{
    return specular * (beckmann_exponential(p, roughness) / (4.0 * PI * square(roughness) * square(p.cos_d)));
}
