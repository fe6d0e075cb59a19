/** The charts that the plot can show. */
export const CHARTS = ["force_time", "force_displacement", "energy", "step_time"] as const;
export type ChartKind = (typeof CHARTS)[number];
