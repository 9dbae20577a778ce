"""What a body is: rows on common frames that keep their places in one moving frame, SE(3) or SE(2).

What methods, joints and links need of it is small; all else here serves these:

- fit poses to rows: :func:`.body.fit_body`, :func:`.body.settled` with one pose for each rest
- residuals of rows under bodies, as costs: :func:`.residuals.body_costs`
- degrees of freedom: :attr:`.body.Body.dof`
- predict: :func:`.body.followed_body`, poses in newer frames for a known template
- describe: :mod:`.kinematics`, twist and pose since birth

Compiled: :mod:`.rotation`, :mod:`.frame_pose`, :mod:`.procrustes`, :mod:`.rest`, :mod:`.residuals`. Arrays
are float64, indices intp and times int64 nanoseconds unless said otherwise. Points have three coordinates; in
2-D the third is zero and rotations are about z. P rows, F frames, K bodies.
"""
