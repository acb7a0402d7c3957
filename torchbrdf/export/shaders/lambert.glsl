vec3 lambert(Pair p, vec3 albedo) { return albedo / PI; }
