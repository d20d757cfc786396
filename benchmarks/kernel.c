/* The loop of the paper (PI or PID, Stenman valve, FOPDT) written by hand, to measure the compiled kernel against. */
#include <math.h>
#include <stdlib.h>

void costs(const double *tunings, long rows, long n, double step, double ts, double tau, double gain, double theta,
           double d, double filter, double *out) {
  double a = exp(-ts / tau);
  long m = (long)floor(theta / ts + 1e-9);
  double f = theta / ts - (double)m;
  if (f < 1e-9) f = 0.0;
  double part = pow(a, 1.0 - f), c0 = 1.0 - part, c1 = part - a;
  double *v = malloc((size_t)n * sizeof(double));
  for (long i = 0; i < rows; i++) {
    double kc = tunings[3 * i], ki = kc * ts / tunings[3 * i + 1], td = tunings[3 * i + 2];
    double tf = td / filter, kd = kc * td, tf_ts = tf + ts;
    double integral = 0, derivative = 0, s_last = 0, x = 0, y = 0, total = 0, e = 0;
    for (long k = 0; k < n; k++) {
      e = step - y;
      double p = kc * (1.0 * step - y);
      integral += ki * e;
      if (kd != 0.0) derivative = (tf * derivative + kd * (e - s_last)) / tf_ts;
      s_last = e;
      double u = 0.0 + p + integral + derivative;
      if (fabs(u - x) > d) x = u;
      v[k] = x;
      double near = k >= m ? v[k - m] : 0.0, far = k > m ? v[k - m - 1] : 0.0;
      y = a * y + gain * (c0 * near + c1 * far);
      double after = step - y;
      total += after * after;
    }
    e = step - y;
    out[i] = 0.5 * total + 0.5 * e * e;
  }
  free(v);
}
