vec3 blinn_phong(Pair p, vec3 specular, float exponent)
{
    return specular * (exp(-0.5 * exponent * log1p(p.tan2_h)) * (exponent + 2.0) / (2.0 * PI));
}
