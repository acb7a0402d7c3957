vec3 ashikhmin_shirley(Pair p, vec3 specular, float exponent, float f0)
{
    float power = exp(-0.5 * exponent * log1p(p.tan2_h)) * (exponent + 1.0) / (8.0 * PI);
    return specular * (power / (p.cos_d * max(p.cos_i, p.cos_o)) * schlick(f0, p.cos_d));
}
