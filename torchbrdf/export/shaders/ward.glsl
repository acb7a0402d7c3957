vec3 ward(Pair p, vec3 specular, float roughness)
{
    float inverse = 1.0 / (roughness * roughness);
    return specular * (exp(-p.tan2_h * inverse) * inverse * inversesqrt(p.cos_i) * inversesqrt(p.cos_o) / (4.0 * PI));
}
