// (e^x - 1) / x
float gtr_q(float x) { return abs(x) < 0.01 ? 1.0 + x / 2.0 + x * x / 6.0 : (exp(x) - 1.0) / x; }

vec3 gtr(Pair p, vec3 specular, float roughness, float exponent, float f0)
{
    float a2 = roughness * roughness, log_square = 2.0 * log(roughness);
    float height = gtr_q(log_square) / gtr_q((exponent - 1.0) * log_square) / (PI * a2);
    float facets = exp(exponent * (log1p(p.tan2_h) - log1p(p.tan2_h / a2))) * height;
    return specular * (facets * ggx_visibility(p, roughness) * schlick(f0, p.cos_d));
}
