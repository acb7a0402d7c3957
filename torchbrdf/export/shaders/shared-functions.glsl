const float PI = 3.14159265358979;
const float LEAST = 1e-10;

// Cosines of the directions and of the half vector's angles, and tan^2 of the latter to the normal. Of what has a grain
// also along tangent and bitangent: slopes of the half vector, and the directions.
struct Pair { float cos_i; float cos_o; float cos_d; float tan2_h; vec2 slope; vec2 along_i; vec2 along_o; };

Pair pair_of(vec3 L, vec3 V, vec3 N, vec3 X, vec3 Y)
{
    vec3 H = normalize(L + V);
    vec2 h = vec2(dot(H, X), dot(H, Y)), slope = h / max(dot(H, N), 1e-15);
    vec2 along_i = vec2(dot(L, X), dot(L, Y)), along_o = vec2(dot(V, X), dot(V, Y));
    return Pair(dot(L, N), dot(V, N), max(dot(L, H), LEAST), dot(slope, slope), slope, along_i, along_o);
}

float square(float x) { return x * x; }

// With all digits near 0.
float log1p(float x)
{
    return x < 0.01 ? x * (1.0 - x * (0.5 - x * (1.0 / 3.0 - 0.25 * x))) : log(1.0 + x);
}

float one_minus_cos_h(Pair p)
{
    float secant = sqrt(1.0 + p.tan2_h);
    return p.tan2_h / ((secant + 1.0) * secant);
}

// 1 - cos_d fifth power, and Schlick's Fresnel.
float schlick_weight(float cos_d) { float x = 1.0 - cos_d; return x * x * x * x * x; }
float schlick(float f0, float cos_d) { return f0 + (1.0 - f0) * schlick_weight(cos_d); }

// exp(-tan2_h / w^2) / cos_h^4
float beckmann_exponential(Pair p, float w) { return exp(2.0 * log1p(p.tan2_h) - p.tan2_h / (w * w)); }

// G / (cos_i cos_o) of V-shaped grooves
float v_groove(Pair p)
{
    float i = max(p.cos_i, LEAST), o = max(p.cos_o, LEAST);
    return min(1.0 / (i * o), 2.0 / (sqrt(1.0 + p.tan2_h) * p.cos_d * max(i, o)));
}

// G / (4 cos_i cos_o) of Smith, heights correlated, for the GGX distribution
float ggx_visibility(Pair p, float a)
{
    float i = max(p.cos_i, LEAST), o = max(p.cos_o, LEAST);
    float s_i = sqrt(a * a + (1.0 - a * a) * i * i), s_o = sqrt(a * a + (1.0 - a * a) * o * o);
    return 0.5 / (o * s_i + i * s_o);
}

// Fresnel's reflectance of unpolarized light for a metal
float metal_fresnel(float eta, float k, float c)
{
    float c2 = c * c, s2 = 1.0 - c2, real = eta * eta - k * k - s2, imaginary = 2.0 * eta * k;
    float length2 = sqrt(real * real + imaginary * imaginary), larger = sqrt(0.5 * (length2 + abs(real)));
    float across_cos = 2.0 * c * (real > 0.0 ? larger : 0.5 * imaginary / larger);
    float across = (length2 + c2 - across_cos) / (length2 + c2 + across_cos);
    float sum = c2 * length2 + s2 * s2;
    return 0.5 * across * (1.0 + (sum - across_cos * s2) / (sum + across_cos * s2));
}

// Along the axes of a grain, whose x axis is turned from the tangent by an azimuth.
vec2 in_the_grain(vec2 v, float rotation)
{
    float c = cos(rotation), s = sin(rotation);
    return vec2(v.x * c + v.y * s, v.y * c - v.x * s);
}

// GGX's distribution of two widths, and what its shadowing is made of.
float grain_distribution(Pair p, vec2 a, float rotation)
{
    vec2 slope = in_the_grain(p.slope, rotation) / a;
    return square((1.0 + p.tan2_h) / (1.0 + dot(slope, slope))) / (PI * a.x * a.y);
}

float grain_length(float cosine, vec2 along, vec2 a, float rotation)
{
    vec2 v = in_the_grain(along, rotation) * a;
    return sqrt(cosine * cosine + dot(v, v));
}
